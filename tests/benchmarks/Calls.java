import java.math.BigDecimal;
import java.nio.charset.StandardCharsets;
import java.nio.file.Files;
import java.util.List;
import org.openapitools.client.ApiClient;
import org.openapitools.client.ApiException;
import org.openapitools.client.api.*;
import org.openapitools.client.model.*;

/** Makes the calls of a client that openapi-generator made; the argument is the daemon's address. */
public class Calls {
    public static void main(String[] arguments) throws Exception {
        ApiClient client = new ApiClient();
        client.updateBaseUri(arguments[0]);
        ResultsApi results = new ResultsApi(client);
        ParticlesApi particles = new ParticlesApi(client);
        LotsApi lots = new LotsApi(client);

        List<Result> items = results.results(0L, null, null, null, null).getItems();
        assert items.get(0).getOutcome() == Result.OutcomeEnum.MEASURED && items.size() == 3;
        Result lean = results.results(0L, 1L, null, null, "lean").getItems().get(0);
        assert lean.getSieveSizeMm().doubleValue() == 10.0;
        assert particles.particle("1").getId().equals(lean.getId());
        assert particles
            .particles("measured", null, null, null, null, null, null, null, null, null, null, null, null, null, null,
                null, null, null, null, null)
            .getItems().size() == 1;
        assert text(particles.meshFile("1", MeshFormat.PLY)).startsWith("ply");
        assert text(particles.preview("1")).startsWith("\u0089PNG");
        assert new HealthApi(client).health().getReady();
        assert new AccountingApi(client).accounting("current").getSession() == 1;
        assert results.parkCursor("mes", new Cursor().after(2L), null).getUnread() == 1;

        Apertures sieves = new Apertures();
        sieves.addAll(List.of(new BigDecimal(4), new BigDecimal(8), new BigDecimal(16)));
        ProductRequest product =
            new ProductRequest().title("own sieves").densityKgM3(new BigDecimal(2850)).sieveSet(new SieveSet(sieves));
        assert lots.putProduct("own", product, null).getSieveSet().getApertures().size() == 3;
        assert lots.product("basalt-8-16", null).getSieveSet().getString().equals("en-basic-2");
        assert lots.postClose("L2", new CloseRequest(), null, null).getState() == LotState.CLOSED;
        LotDocument opened = lots.postLot(new LotRequest().lot("L3").product("own"), "one");
        assert lots.postLot(new LotRequest().lot("L3").product("own"), "one").equals(opened);
        assert lots.listLots(null, null, null, null).getItems().size() == 3;
        assert text(lots.reportFile("L1", ReportFormat.PDF, null, null, null)).startsWith("%PDF");
        try {
            lots.getLot("L9");
            assert false;
        } catch (ApiException error) {
            assert error.getCode() == 404 && error.getResponseBody().contains("urn:stonefall:problem:unknown-lot");
        }
        System.out.println("all calls were answered as described");
    }

    private static String text(java.io.File file) throws java.io.IOException {
        return new String(Files.readAllBytes(file.toPath()), StandardCharsets.ISO_8859_1);
    }
}
