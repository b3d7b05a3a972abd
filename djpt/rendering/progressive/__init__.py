"""Renders whose images exceed the memory, or that take so long that they show partial images and can be continued."""
