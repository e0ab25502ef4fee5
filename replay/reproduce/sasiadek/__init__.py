"""Sasiadek and Hartana 2004: GPS/INS fusion from pseudoranges, with satellites chosen by DOP."""

from replay.reproduce.sasiadek.experiment import SEEDS, reproduce

__all__ = ["SEEDS", "reproduce"]
