"""Plain plumbing: files and what they may be, the cache, Ctrl-C, memory, processes, packages, cards."""
