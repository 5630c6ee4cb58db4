"""Why a fit is poor: hypotheses about robot and log tried cheaply, the one that explains named."""
