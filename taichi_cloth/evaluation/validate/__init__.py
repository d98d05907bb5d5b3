"""References with known answers, and the errors of the solvers against them (`taichi-cloth validate`)."""
