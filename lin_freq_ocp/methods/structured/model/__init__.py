"""The data of the structured interior point: stages, and the rows that couple their times."""
