"""What every method learns with: batches from episodes, the paper's equations, networks, and the engine."""
