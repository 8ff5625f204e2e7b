"""The plan of a run, made from headers and without torch, and the reading of its frames.

- ``job``: a request, and the prepared run with its early checks
- ``make_plan``, ``plan``: making the plan, and its records
- ``needs``: what a run needs and leaves out, in sentences
- ``remarks``: what may surprise at the end of a run, in sentences
- ``materials``: the look's material, materials that hide the look, and lights, in sentences
- ``estimate``: memory, time and disk
- ``windows``: the frames of each window
- ``frames``: the grids of a frame, found by header
- ``copied``: other grids that go into the result's files as they are
- ``frame_reader``: the fields of a frame, read
- ``visibility``: what a shot's camera can see, and the size of voxels in its picture
- ``networks``: the feature network, its layers and hash; the network that frames start from
- ``stage_values``, ``output_folder``: settings that the stage gives; the output folder
"""
