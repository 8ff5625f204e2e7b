"""One run: its folder, the coarse step, windows, the assembly, and what is written about it.

The files are imported by name, because most of them load OpenUSD.

- ``run``: the run on disk: folder, record, manifests, claims of processes on its tasks
- ``manifests``: what a finished window or the coarse step has left
- ``identity``: what decides a result, and whether a call asks for a run's
- ``run_machine``: device and kind of processor of a run
- ``changes``: what differs between two runs, in words
- ``opening``: which run a call belongs to, and results that are made longer (a folder)
- ``opened``: a run that this process works on: what is left to do, disk, how far
- ``coarse``: the measured scenes, and the coarse step that all windows start from
- ``window``: frames are checked, stylized and written, window by window
- ``outputs``: one frame's grids, file and entry in the manifest; a Volume's frames for the layer
- ``assemble``: frames of two windows are blended, the look layer is written
- ``delivery``: finished frames under the paths of ``layer.files``
- ``provenance_record``: the record of a finished run, and the metadata of a frame's file
- ``train``: networks that frames start from, trained for a file or in a run, and tried
- ``sheet``: contact sheets
- ``progress``: how far a run is, as a record
- ``budget``: the error budget (a folder)
"""
