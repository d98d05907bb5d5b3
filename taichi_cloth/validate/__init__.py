"""References with known answers, and how far the solvers are from them (`taichi-cloth validate`)."""
