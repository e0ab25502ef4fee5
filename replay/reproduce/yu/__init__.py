"""Yu et al. 2018: direct kinematic filter of three IMUs, with mechanisms for smooth transitions."""

from replay.reproduce.yu.experiment import SEEDS, reproduce

__all__ = ["SEEDS", "reproduce"]
