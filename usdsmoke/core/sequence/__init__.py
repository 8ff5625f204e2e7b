"""Frames in order: windows, the shared coarse step, motion, and the errors that remain.

``controls`` needs no torch: planning reads it.

- ``stylize``: the stylized frames of one window
- ``frame_state``: one immutable record for each phase of a frame
- ``frame_loop``: the phases: opened, shaped, moved, painted, finished
- ``controls``: the settings of each frame, and which frames are computed
- ``start``: where a frame's optimisation starts: its neighbour and the coarse step
- ``transit``: where the smoke of one frame is in its neighbour
- ``cuts``: smoke that jumps, and velocities that do not explain it
- ``coherence``: results carried along by the velocity, averaged
- ``steadiness``: the temporal error: what does not move with the smoke
- ``coarse``: the shared coarse step
- ``start_files``: its results, and checkpoints of windows, as files
- ``motion``, ``motion_energy``: the velocity of smoke that comes without one
- ``error_estimates``, ``picture_errors``: what is left of a frame's errors
"""
