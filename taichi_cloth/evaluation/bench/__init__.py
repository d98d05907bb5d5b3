"""Frame times on this machine, compared with the same frames in C and JavaScript, and the strain of the cloth."""
