"""Rendering: camera, draw list, lighting, the rasterizer, and the images, videos and WebGL data made with them."""
