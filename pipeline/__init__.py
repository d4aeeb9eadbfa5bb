"""Data flow of a run.

::

    envs.make_env -> Collector(actor) -> batch [num_envs, T]
       batch_process        EpisodeHook    cuts the stream into whole episodes: statistics, SID,
                                           backtracking (the actor returns to its last good weights)
                            StoreHook      n-step rewards, flatten -> main replay buffer
       process_optim_batch  Mixture        exact row counts from main and D = demo + grown
       optimization_stepper BCSACStepper   critic -> actor (RL and BC) -> temperature -> target
       post_optim           DemoUpdateHook Algorithm 1 of the paper: an extra update on D
                            ActorAverageHook
       post_optim_complete_log             log_metrics: the averaged metrics of the steps, by name
       pre_steps_log        EpisodeHook, GrownHook
       post_steps_log       EvaluationHook; then Trainer saves a checkpoint

``build.py`` is the composition root and the only module that knows all the others.
"""
