"""What priorities, CPUs of one's own and limits are worth beside a greedy node."""
