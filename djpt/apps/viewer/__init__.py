"""The page that shows a render while it is computed: a local server, and a session that renders the current view."""
