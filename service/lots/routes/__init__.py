"""Routes of products, lots and their figures, the crusher's diary, and the laboratory."""

from service.lots.routes import diary, laboratory, lot_figures, lots, products, stone_files

ROUTERS = (
    products.router,
    lots.router,
    lot_figures.router,
    lot_figures.windows,
    diary.router,
    laboratory.router,
    stone_files.router,
)
