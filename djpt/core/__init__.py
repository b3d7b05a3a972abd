"""Records, frames, transforms, warps and files, which everything may use; nothing here knows of scenes."""
