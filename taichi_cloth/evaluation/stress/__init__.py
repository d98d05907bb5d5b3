"""Forty stress cases that break cloth: which settings survive each, and by how much the others fail."""
