"""How fast the cloth is on this machine, beside the same frame in C and in JavaScript, with its strain next to it."""
