"""Forty cases that break cloth: which solver stays alive in which, and by how much the others fail."""
