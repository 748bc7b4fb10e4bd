"""What is shown of a run: live, as lines, as JSON, and the summary at its end."""
