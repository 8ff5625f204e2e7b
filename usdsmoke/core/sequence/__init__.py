"""Frames of a window one after another, the coarse shot, and what is left of their errors."""
