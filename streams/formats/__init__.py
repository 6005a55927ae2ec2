"""Other tools' formats: read into recordings, written from them."""
