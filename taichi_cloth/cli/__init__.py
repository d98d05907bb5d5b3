"""The command line of taichi_cloth: one module per group of commands."""
