"""Other tools' formats: importers and exporters."""
