"""Errors, files, progress display, and everything that depends on the installed Taichi."""
