"""What people run: the command line, the simulated mines, evaluation and reports."""
