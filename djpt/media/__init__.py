"""What fills the space between surfaces."""
