"""Code needed only for the paper's tables: `meshdeform reproduce` uses it, no default does."""
