"""Every table and figure of the paper on one page, ours beside the paper's."""
