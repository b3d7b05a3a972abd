"""The tools that compare renderers are themselves tested."""
