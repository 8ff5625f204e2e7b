"""Queues and clusters. Both only call the pipeline.

- ``dask``: windows as tasks of a Dask cluster
- ``openjd``: a run as a job for a render queue, in Open Job Description
"""
