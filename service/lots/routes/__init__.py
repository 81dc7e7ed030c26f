"""Routes of products, lots and their figures, the crusher's diary, and the laboratory."""

from service.lots.routes import diary, laboratory, lot_figures, lots, products, windows

ROUTERS = (products.router, lots.router, lot_figures.router, windows.router, diary.router, laboratory.router)
