"""The paper's `door` task: an Adroit hand turns a latch and opens a door.

`task` says what the task *is* (observation layout, reward, termination) as pure functions;
`scene` and `simulator` make MuJoCo play it; `torchrl_env` and `gymnasium_env` show it to learners;
`metrics` summarises episodes as Tables I and II of the paper do; `render` takes pictures.
"""
