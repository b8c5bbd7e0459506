"""Maps that were made elsewhere: files in, checked statements out. A file is used whole or not at all."""
