"""What is learned and how: networks, gradients, optimizers, the update. Knows no buffer."""
