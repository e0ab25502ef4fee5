"""Duong & Chiang 2012: smoothing on line after every fix."""

from replay.reproduce.duong.experiment import SEEDS, reproduce

__all__ = ["SEEDS", "reproduce"]
