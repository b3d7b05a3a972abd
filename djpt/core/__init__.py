"""What everything may use: records, frames, transforms, warps, files. It knows nothing of scenes."""
