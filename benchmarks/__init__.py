"""Speed and memory of this project beside others', measured the same way at the same time.

::

    cli.py         python -m benchmarks: sections -> results/latest.json and .md
      roofline, update, environment, loop, evaluation, memory, scaling, rlpd, paper_preset:
                   a module each, whose ``run`` returns top-level keys of the JSON file
    worker.py      one process per contestant; the parent goes round-robin over them
    effort.py      how long each section measures
    ours.py        this project's side, built from its own configuration and factories
    baselines.py   stable-baselines3, sbx and torchrl's SACLoss; redq.py: torchrl's REDQLoss
    bars.py        what the project wants to reach, evaluated on the JSON file
    report.py      the Markdown tables, from the JSON file alone

Modules that workers import first (``worker``, ``statistics``) do not import torch: thread counts
must be in the environment before it is loaded.
"""
