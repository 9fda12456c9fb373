"""What our processes need from their machine: descriptors, priorities, logs, threads, the service's folders."""
