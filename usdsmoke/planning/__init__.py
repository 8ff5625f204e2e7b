"""What a run will do, decided before voxels are read and without torch.

- ``job``: a request and the run that it leads to, with all that can be refused early
- ``make_plan``, ``plan``: the plan is made, and its records
- ``needs``: what a run needs and leaves out, in sentences
- ``estimate``: memory, time and disk
- ``windows``: which frames belong together
- ``frames``, ``frame_reader``: the fields of a frame, found by header and read
- ``visibility``: what a shot's camera can see
- ``features``, ``stage_values``, ``output_folder``: network file, stage values, output folder
"""
