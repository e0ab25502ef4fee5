"""What each command takes, with its help; what is heavy is imported inside the functions."""
