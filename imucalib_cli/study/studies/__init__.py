"""The studies: what each varies, measures, prints and draws."""
