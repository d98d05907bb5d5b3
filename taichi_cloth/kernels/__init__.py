"""Taichi functions on particles and springs: forces, constraints, integration, linear solvers."""

from ..system.kernel_parsing import replace_class_check

replace_class_check()  # before the first decorator
