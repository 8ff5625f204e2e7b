"""Queues and clusters: Open Job Description and Dask. Both only call the pipeline."""
