"""The paper's `door` task: an Adroit hand turns a latch and opens a door.

`task` says what the task *is* (observation layout, reward, termination) as pure functions; `hand`
makes MuJoCo play it; `definition` names everything that the project may ask of it; `gymnasium_env`
shows it to tools that speak gymnasium; `metrics` summarises episodes as Tables I and II of the
paper do. What every task of the hand needs, its batched environment above all, is in `envs.adroit`.
"""
