"""Pictures of what a run has written."""
