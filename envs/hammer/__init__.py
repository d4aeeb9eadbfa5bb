"""The suite's `hammer` task: a hand picks up a hammer and drives a nail into a board."""
