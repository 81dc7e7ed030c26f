"""What all rooms use and that uses none of them: states, errors, languages, paths, schemas."""
