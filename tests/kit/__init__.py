<<<<<<< HEAD
"""Helpers of the tests."""
=======
"""What tests share."""
>>>>>>> c0fa043 (Let tests choose how many lanes kernels have)
