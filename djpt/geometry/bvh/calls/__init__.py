"""Ray queries by functions that Python writes and LLVM compiles."""
