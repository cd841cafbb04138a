"""Other controllers as contenders: policies in files."""
