"""Queues and clusters. Both only call the pipeline.

- ``tasks``: a run divided into the coarse step and windows
- ``processes``: windows as processes of this machine
- ``dask``: windows as tasks of a Dask cluster
- ``openjd``: a run as a job for a render queue, in Open Job Description
"""

from usdsmoke.farm.dask import stylize_on_cluster
from usdsmoke.farm.openjd import JobBundle, submit
from usdsmoke.farm.processes import choose_jobs, stylize_in_processes, with_jobs

__all__ = [
    "JobBundle",
    "choose_jobs",
    "stylize_in_processes",
    "stylize_on_cluster",
    "submit",
    "with_jobs",
]
