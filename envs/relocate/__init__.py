"""The suite's `relocate` task: a hand carries a ball to a place in the air."""
