"""Speed beside error: every solver at many settings, against one known motion (`taichi-cloth bench --error`)."""
