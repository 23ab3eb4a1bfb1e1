"""Recordings through the nodes' code: one bag as a job, many of them in processes or on Dask."""
