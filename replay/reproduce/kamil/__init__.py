"""Kamil et al. 2014: low-cost tracking with MEMS sensors and simplified two-filter smoothing."""

from replay.reproduce.kamil.experiment import SEEDS, reproduce

__all__ = ["SEEDS", "reproduce"]
