"""What the tasks of the Adroit hand share: the model's files, a batched simulator, an environment.

A hand task is an `envs.adroit.hand.HandTask`: what of the model differs between copies, what is
read after a step, how these become observations, rewards and successes. Everything else is here.
"""
