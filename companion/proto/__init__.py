"""Protobuf messages of the run log and of the zenoh keys; see ``regenerate.sh``."""
