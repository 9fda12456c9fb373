"""Serves our processes on their machine: descriptors, priorities, logs, threads, the service's folders."""
