"""Data flow of a run.

::

    envs.make_env -> Collector(actor) -> batch [num_envs, T]
       batch_process        EpisodeHook    cuts the stream into whole episodes: statistics, SID,
                                           backtracking (the actor returns to its last good weights)
                            StoreHook      n-step rewards, flatten -> main replay buffer
       process_optim_batch  Mixture        exact row counts from main, D = demo + grown, and
                                           sources of a user
       optimization_stepper BCSACStepper   critic -> actor (RL and BC) -> temperature -> target
       post_optim           DemoUpdateHook Algorithm 1 of the paper: an extra update on D
                            ActorAverageHook
       post_optim_complete_log             BCSACStepper.log_metrics: the steps' averages, by name
       pre_steps_log        EpisodeHook, GrownHook
       post_steps_log       EvaluationHook; then Trainer saves a checkpoint

``build.py`` is the composition root and the only module that knows all the others. What lies at
the top of this package composes; the rooms below it, each knowing only those under it::

    commands                 what is done with a finished run
    film                     who is filmed, what is drawn and written
    report > results         pages and tables, from files alone
    hooks > watch            what happens between updates; what a living run is judged by
    act > data > learn       what is played, what a batch is made of, what is learned
    machine > files          what the machine gives; what is left on disk
"""

import bcsac

# Before anything else of ours is imported: a user may have folders of the same names.
bcsac.claim()
