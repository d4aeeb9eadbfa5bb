"""What a run leaves on disk: names, format, sums, checkpoints, curves; no policy is made here."""
