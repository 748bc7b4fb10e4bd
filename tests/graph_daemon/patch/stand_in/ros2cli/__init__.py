"""Made up for tests: shaped like ros2cli where the overlay takes hold, and nothing else."""
