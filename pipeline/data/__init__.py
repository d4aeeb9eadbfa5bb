"""What a batch is made of: rows, buffers, their mixture, episodes and what they grow into."""
