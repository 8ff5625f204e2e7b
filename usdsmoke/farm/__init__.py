"""Queues and clusters. Both only call the pipeline.

- ``tasks``: a run divided into the coarse step and windows
- ``processes``: windows as processes of this machine
- ``dask``: windows as tasks of a Dask cluster
- ``openjd``: a run as a job for a render queue, in Open Job Description
"""
