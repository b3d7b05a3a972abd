"""The page that shows a render while it is computed: a local server, and a session that renders what is looked at."""
