"""Clock estimators under several laws of delay, ours beside the paper's."""
