"""How long each section may measure."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Effort:
    """Rounds, blocks and frames of a run.

    The full effort takes about a quarter of an hour on two idle cores; the quick one shows in a
    few minutes that everything runs, and its numbers are not to be quoted.
    """

    quick: bool
    threads: int
    """Threads of every contestant where the section does not vary them."""
    rounds: int = 6
    block_s: float = 0.4
    replay_rows: int = 100_000
    demo_rows: int = 5_000
    evaluation_doors: int = 1_000
    evaluation_rounds: int = 2
    train_frames: int = 50_000
    paper_frames: int = 2_000
    memory_frames: int = 500
    env_counts: tuple[int, ...] = (1, 8, 64, 1000)
    env_block_s: float = 0.8

    @classmethod
    def make(cls, *, quick: bool, threads: int) -> Effort:
        """The full effort or the quick one."""
        if not quick:
            return cls(quick=False, threads=threads)
        return cls(
            quick=True,
            threads=threads,
            rounds=3,
            block_s=0.1,
            replay_rows=10_000,
            evaluation_doors=50,
            evaluation_rounds=1,
            train_frames=2_000,
            paper_frames=60,
            memory_frames=20,
            env_block_s=0.2,
        )

    def as_json(self, **values: object) -> dict[str, object]:
        """What every result block says about how it was made."""
        return {"quick": self.quick, "threads": self.threads, **values}
