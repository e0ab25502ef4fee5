"""What arrives, in the estimator's own terms: rows for its kernels, checked, counted, in order."""
