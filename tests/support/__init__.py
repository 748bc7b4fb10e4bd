"""What several tests need to talk to the real things."""
