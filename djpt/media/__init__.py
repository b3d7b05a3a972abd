"""Media: matter between surfaces that takes light away."""
