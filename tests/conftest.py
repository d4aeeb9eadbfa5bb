"""What holds for all tests."""

from hypothesis import HealthCheck, settings

# Property tests judge results, not the machine: a busy one draws and computes slowly. The same
# examples each time, so that a failure is the change's and not the draw's.
settings.register_profile(
    "ours", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("ours")
