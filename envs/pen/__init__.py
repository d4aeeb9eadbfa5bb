"""The suite's `pen` task: a hand turns a pen until it points as asked."""
