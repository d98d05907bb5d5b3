"""Colliders and how the cloth is kept out of them."""
