"""Many cloths at once: the same kernels, with linear algebra batched by PyTorch, on a GPU or on the CPU."""
