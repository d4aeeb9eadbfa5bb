"""The machine a run has: threads, compiled updates, products, graphs, disk, signals."""
