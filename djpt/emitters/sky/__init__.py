"""The sky and the sun of Hosek and Wilkie: their tables, radiance, and the sampling of directions."""
