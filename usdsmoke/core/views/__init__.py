"""Cameras and optics: projection, ray marching, visibility, the scene's extinction."""
