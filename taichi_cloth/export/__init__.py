"""Export of the cloth to files of other programs: meshes, point caches, USD and HTML pages."""
