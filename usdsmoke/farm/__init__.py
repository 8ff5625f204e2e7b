"""Queues and clusters. Both only call the pipeline.

- ``dask``: windows as tasks of a Dask cluster
- ``openjd``: a run as a job bundle for a render queue
- ``openjd_template``: the job template in Open Job Description
"""
