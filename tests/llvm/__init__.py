"""The builder of LLVM IR, and its compiler."""
