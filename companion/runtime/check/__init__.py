"""Looking before flying: open what a configuration names, listen, and say what is missing.

``tally`` counts what arrives and ``findings`` judges it, both pure; ``listen`` owns the links.
"""
