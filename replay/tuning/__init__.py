"""Noise parameters from data: Allan deviation at rest, innovations of a flight."""
