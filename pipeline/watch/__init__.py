"""What a living run is judged by: diagnostics, the alarm, loggers."""
