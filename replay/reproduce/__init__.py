"""The papers' experiments on simulated sensors: ``companion reproduce PAPER``.

A module or subpackage a paper, each with ``reproduce(out, seeds, progress)`` that gives a
:class:`~replay.reproduce.paper.Reproduction`, and ``SEEDS``, how many by default.
"""
