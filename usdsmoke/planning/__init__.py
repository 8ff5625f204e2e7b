"""What a run will do, decided before voxels are read: frames, windows, needs, cost."""
