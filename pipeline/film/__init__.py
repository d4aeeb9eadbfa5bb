"""Films of policies and demonstrations: which episodes, what is played, drawn and written."""
