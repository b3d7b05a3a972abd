"""Emitters and the choice between them."""
