"""What is played: exploration, rollouts, evaluation, and what a set of episodes achieved."""
