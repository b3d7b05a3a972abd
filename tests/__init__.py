"""The tests of djpt, in folders by concept; `tests.kit` holds what several of them use."""
