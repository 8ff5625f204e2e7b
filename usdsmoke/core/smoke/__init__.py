"""Smoke as tensors: active voxels, noise, sRGB, device, and the octave schedule."""
