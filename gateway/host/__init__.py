"""What any process of ours asks of its machine: descriptors, priorities, logs, threads, the service's folders."""
