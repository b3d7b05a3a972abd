"""Parts of Metropolis light transport: Markov chains and their mutations."""
