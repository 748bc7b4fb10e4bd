"""What has to be done so that a running system becomes the one that a configuration describes."""
