"""What is done with a finished run: one file for each command."""
