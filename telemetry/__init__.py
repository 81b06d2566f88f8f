"""One dictionary of what is said, its codecs, recorder and decoders."""
