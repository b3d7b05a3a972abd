"""`render` as an operation that Dr.Jit can differentiate: path replay, or automatic differentiation."""
