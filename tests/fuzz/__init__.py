"""Every reader of bytes that strangers can send or leave behind, under a fuzzer."""
