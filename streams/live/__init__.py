"""Live transport of samples between two programs: sender, receiver, reordering, recorder."""
